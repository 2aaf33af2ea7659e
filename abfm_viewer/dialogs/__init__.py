"""Modal dialogs: choice of files, questions and messages."""

from abfm_viewer.dialogs.dialogs import Dialogs as Dialogs
