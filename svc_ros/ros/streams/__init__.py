"""What happens to clouds between the two: queues, workers, engines."""
