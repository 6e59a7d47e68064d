"""The browser page, its server and its exports; a leaf that nothing below imports."""
