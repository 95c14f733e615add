"""What is mounted on a board: whether each part is there, where, turned by how much, and the right way round."""
