"""The published pipeline: blobs, association, hold."""
