"""The command for films of functions, and what is told of them."""
