"""The objective of a match: the regularity of the fields plus data terms, with gradients."""
