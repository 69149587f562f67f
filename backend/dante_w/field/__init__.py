"""The paper's model (field): albedo and irradiance as two fields, fitted to the photos by gradient descent.

    terms            what is minimised, as data
    hash_encoding    grids of features, and how a point reads them
    fields           the two fields and the photos' own parameters: the model's definition, in plain torch
    loss             Eq. 6 and 7 of the paper, in plain torch
    batches          which samples of the ray cache a step sees
    step             what a step of the fit is; the reference in plain torch
    cpu, cuda        steps and values by numba and by Triton (experimental)
    divergence       rejects steps after which the loss has risen
    fit_state        a fit under way, as it is kept for --resume
    optimise         the fit
    inference        values of the fields without gradients
    held_out         how well photos that the fit never saw are re-rendered
    scale_ambiguity  the gain between albedo and light that photos leave open

A file imports from those above it.
"""
