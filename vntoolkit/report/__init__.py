"""Floor 3, what people look at: figures, tables, pages, the viewer."""
