"""Drive the app by the labels of its widgets, with or without a screen."""

from abfm_viewer.automation.driver import Driver as Driver
