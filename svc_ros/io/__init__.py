"""Outside formats to core types and back."""
