"""Recording a camera: files that grow, a manifest beside them, and a live copy for viewers."""
