"""Quality and cost of images on disk, as records on disk."""
