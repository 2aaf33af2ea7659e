"""Drive the app by the labels of its widgets, with or without a screen."""
