"""Requests at little cost: files of a page from memory, and routes that decline quickly what is not for them."""
