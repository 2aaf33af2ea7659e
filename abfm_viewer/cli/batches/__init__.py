"""Tables of problems: the commands that solve them, and what is told of them."""
