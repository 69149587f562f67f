"""The solver of traced light: lights, exposures and albedo that explain the photos (docs/method.md has more).

Photo k, taken under light j = j(k) with the exposure exp(g_k), shows point c as

    p_ck = exp(g_k) (a_c E_cj + S_ck),        E_cj = sum over d of T_cd L_jd + B_cj

with the albedo a, the irradiance E over pi, the radiance L_jd of light j from direction d, direct light transport T, light B
bounced by the mesh, and specular radiance S. All are linear Rec.709 and relative: a uniform sky of radiance 1 gives an open point E = 1.

**Unknowns**, all natural logs: l_jd = log L_jd (`Lighting.radiance`), g_k (`Lighting.log_exposure`), x_c = log a_c
(`Lighting.albedo`); and which light each photo has (`Lighting.cluster`). B and S follow from the present lights and albedo.

**Objective**, minimised over l and g, with x projected out:

    F(l, g) = kappa / 2 [ sum_ck w_ck phi(r_ck) + sum_c tau_c |x_c - xhat_c|^2 + sum_cc' e_cc' |x_c - x_c'|^2 ]
              + 1/2 sum_j Pi(l_j) + 1/2 sum_k (g_k - ghat_k)^2 / sigma_g^2

| term | here |
|---|---|
| data: r = log p - log of the model, phi a Cauchy loss, w the weight of an observation | `evidence`, `variable_projection` |
| albedo prior xhat with the weight tau | `state.AlbedoPrior` |
| smoothness prior: e couples neighbouring points | `smoothness_prior` |
| light prior Pi: a Gaussian process on the sphere | `light_prior` |
| exposure prior ghat with the deviation sigma_g | `evidence.ExposurePrior` |

**Algorithm.** For given lights the best x follows point by point (`variable_projection`; Golub and Pereyra, "The
differentiation of pseudo-inverses and nonlinear least squares problems whose variables separate", 1973). The gain per channel
that F leaves open is set by a rule (`albedo_scale`). Steps change l and g alone: damped Gauss-Newton
(`normal_equations`) by conjugate gradients (`pcg`), each accepted or rejected by its cost (`step_control`,
`levenberg_marquardt`). The problem is ill-conditioned, not large: a dozen such steps do what gradient descent on
everything does not in thousands. First steps see few directions and let photos change their light, later ones see all (`solve_lights`).
"""
