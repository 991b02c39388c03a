"""What users add in a file of their own: one thing each, and no edit of the package."""
