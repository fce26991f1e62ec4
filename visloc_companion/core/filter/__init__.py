"""The position filter's beliefs and steps as pure functions: motion, fixes, refusals, and the solutions that leave fixes out."""
