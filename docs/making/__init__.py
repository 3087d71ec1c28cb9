"""What of the documentation is made from the code: pages of the reference, drawings, tables of figures.

Plain functions from the code to Markdown or SVG; `hooks.py` alone knows the site generator.
"""
