"""What runs off the frame loop: function values and matches."""
