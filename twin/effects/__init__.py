"""The pages of physics; twin.effects.catalogue lists them."""
