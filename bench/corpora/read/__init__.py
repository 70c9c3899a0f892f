"""One file per format that can be imported; the limits of the libraries bound time and memory."""
