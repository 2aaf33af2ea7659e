"""Drawing of the surfaces, and of everything on and over them, with polyscope."""
