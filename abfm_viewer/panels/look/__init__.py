"""The tab Look: what the surfaces show."""
