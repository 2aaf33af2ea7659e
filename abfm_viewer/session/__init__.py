"""A document at work: every change of it, the run under way, what the status line says."""
