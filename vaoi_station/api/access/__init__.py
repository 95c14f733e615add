"""The rights of callers: keys and their scopes, the login of the page, and the audit log."""
