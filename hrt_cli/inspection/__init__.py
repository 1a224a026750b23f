"""What files are, whether they will work, and what to run on them."""
