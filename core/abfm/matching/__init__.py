"""Finding the field whose flow carries a source to a target."""
