"""Static pages about results: HTML templates with facts, tables and pictures."""
