"""Pictures off the screen: of documents, sheets, movies, figures."""
