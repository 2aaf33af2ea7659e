"""Initial maps between two surfaces, from what is known of them: one way a file."""
