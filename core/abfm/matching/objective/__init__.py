"""What a match minimises: the regularity of the fields plus data terms, with exact gradients."""
