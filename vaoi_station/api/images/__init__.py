"""The images of a component over REST: query parameters that choose them, and the entries that describe them."""
