"""Commands for two surfaces: the registration, what it carries, and what its map does."""
