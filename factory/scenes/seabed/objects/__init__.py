"""What lies and stands on procedural ground: meshes of every kind, and where they are put."""
