"""What the tracker shows when it is tried on the recording: suitable steps, and its own rests."""
