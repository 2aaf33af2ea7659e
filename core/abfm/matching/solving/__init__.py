"""The descent: levels, stages, descent, pause and cancel."""
