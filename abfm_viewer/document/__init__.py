"""What the user made, as immutable values: document, history, and what they are filled with."""
