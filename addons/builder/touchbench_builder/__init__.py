"""From recordings to C for a microcontroller, with a certificate for people who were never recorded."""
