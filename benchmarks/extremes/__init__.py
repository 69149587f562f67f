"""What `python3 dev.py bench stability` puts a small scene through, one family of extremes a file."""
