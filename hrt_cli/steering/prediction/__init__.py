"""What a model says of pictures, folders and videos."""
