"""The solver of a match: continuation, schedule, levels, descents and their record."""
