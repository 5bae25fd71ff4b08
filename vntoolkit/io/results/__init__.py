"""Files of a result folder beside the maps: manifest, frame log, moving mesh, seams."""
