"""One long recording on many cores: cut with an overlap, tracked in pieces, and joined."""
