"""ImGui widgets, containers and plots, independent of matching."""
