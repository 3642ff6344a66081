"""The shading layer: reflectance models evaluated on batches of normals, lights and views."""
