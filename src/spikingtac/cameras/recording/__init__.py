"""Recording a camera: files that grow, a manifest beside them, and a copy for who watches."""
