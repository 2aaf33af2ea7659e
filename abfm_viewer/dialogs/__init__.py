"""Dialogs, which must be answered first: files to choose, questions, things to read."""

from abfm_viewer.dialogs.dialogs import Dialogs as Dialogs
