"""See docs/reference/grading.md."""
