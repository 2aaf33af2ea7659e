"""What is in files, and writing pictures, movies and data next to the running app."""
