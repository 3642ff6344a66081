"""ONNX graphs: built or traced, then verified against torch."""
