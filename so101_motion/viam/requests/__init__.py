"""DoCommand requests of the published module and of ours, and how the module waits for motions."""
