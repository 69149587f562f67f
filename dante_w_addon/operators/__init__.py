"""The buttons: each checks what it needs, calls the rooms below, and reports."""
