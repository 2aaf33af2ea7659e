"""What a match is worth: whether it can arrive, whether it did, and in which words."""
