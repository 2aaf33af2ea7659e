"""Static pages about results: HTML templates, filled with facts, tables and pictures."""
