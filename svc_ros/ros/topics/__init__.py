"""What comes in and goes out: messages, and the plain values that they carry."""
