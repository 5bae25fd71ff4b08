"""Floor 3.5, output for people: figures, tables, HTML pages, the viewer."""
