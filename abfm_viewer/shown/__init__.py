"""What pictures show: functions along the flow, the field, streaks, comparisons."""
