"""What a match is to bring together: data terms, one kind a file."""
