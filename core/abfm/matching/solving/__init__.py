"""The way down: levels, stages, descent, pause and cancel."""
