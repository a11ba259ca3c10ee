"""What is wrong with a bag before anybody registers it."""
