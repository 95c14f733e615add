"""What the pictures of a camera are worth: errors of its lens, and blur."""
