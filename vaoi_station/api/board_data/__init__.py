"""Board data over REST: a file is uploaded, its import previewed and corrected, and confirmed as a board type.

Importers run in processes of their own. Uploads and previews are limited in number, size and age.
"""
