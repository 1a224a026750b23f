"""The network as an ONNX file, and back."""
