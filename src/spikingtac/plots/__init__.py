"""Pictures, drawn with Matplotlib; a leaf that nothing but the faces imports."""
