"""The network: architecture, ONNX export, integer graph."""
