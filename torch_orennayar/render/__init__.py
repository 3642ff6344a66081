"""The rasteriser: from a mesh and a camera to normals, depth, silhouettes, cast shadows and radiosity."""
