"""Record people on a skin of your own: prompts, checks of the sensor, files to import."""
