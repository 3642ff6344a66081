"""Diffuse and specular reflectance models, the theory that judges them, and the choice among them."""
