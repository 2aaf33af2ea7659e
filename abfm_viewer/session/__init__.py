"""Sessions: editing a document, opening and saving, runs, playback and messages."""
