"""The flow of a field: functions carried along it, and points that follow it."""
