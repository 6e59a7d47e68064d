"""The pipeline: events in, marker frames out."""
