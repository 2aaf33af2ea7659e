"""The window: frame loop, menus, keys, mouse, recovery."""
