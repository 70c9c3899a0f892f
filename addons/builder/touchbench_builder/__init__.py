"""From recordings to C for a microcontroller, with a certificate for new people."""
