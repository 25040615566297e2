"""Systems that only tables and the study need, run by ONNX Runtime."""
