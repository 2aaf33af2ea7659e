"""Long work: how far it is, whether it is still wanted, and processes that it runs in."""
