"""Sessions of the app: editing and saving of documents, runs of the solver, playback, messages.

A document is everything that the user works on at a time: input, result and view. A session has one
current document, and a history of earlier ones for undo.
"""
