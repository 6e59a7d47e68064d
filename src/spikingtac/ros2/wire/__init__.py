"""What is sent: definitions of messages, their names, hashes, types and bytes."""
