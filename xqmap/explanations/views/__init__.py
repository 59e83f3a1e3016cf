"""A decision as pictures, charts, sentences and a page."""
