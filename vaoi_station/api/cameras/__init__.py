"""REST: what each camera shows at present, and the findings of `vaoi doctor`."""
