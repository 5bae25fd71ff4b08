"""Floor 3.7, the live view: sources, processing, recorder, server and page."""
