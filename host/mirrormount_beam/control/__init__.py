"""The loop that keeps a beam at its targets: what it measures, decides, drives and learns."""
