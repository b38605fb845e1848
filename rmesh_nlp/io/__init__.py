"""Files in and out: problem files, records, fields, meshes."""
