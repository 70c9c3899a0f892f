"""Readers, a file per format; the limits of the libraries bound time and memory."""
