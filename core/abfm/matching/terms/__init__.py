"""The data terms of a match: functions, landmarks and their protocol."""
