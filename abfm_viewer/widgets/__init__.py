"""ImGui widgets with undo, errors and labels; they know nothing of matching."""
