"""The paper's figures, drawn: sheets of panels and plots, and a page with all of them."""
