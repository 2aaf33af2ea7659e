"""Search for an initial map: candidates are relaxed and compared on coarse surfaces."""
