"""ONNX graphs: built or traced from torch, then verified against it in ONNX Runtime.

``api`` asks one of the ``*_graph`` modules for a task; these build on ``nodes``. ``verify``, ``describe`` and
``half_precision`` work on any graph.
"""
