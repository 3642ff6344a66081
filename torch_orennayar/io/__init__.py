"""Files in and out: images, captures, figures, reports and results."""
