"""Who may do what: keys and their scopes, the login of the page, the audit log."""
