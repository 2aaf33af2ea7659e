"""Critical points of fields, their tracks through time, and episodes."""
