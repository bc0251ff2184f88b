"""Files that other programs read: loop closures, maps, fitted parameters."""
