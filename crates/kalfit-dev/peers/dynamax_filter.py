import os

os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"

import common

try:
    import jax

    jax.config.update("jax_enable_x64", True)
    import jax.numpy as jnp
    from dynamax.linear_gaussian_ssm import LinearGaussianSSM
    from dynamax.linear_gaussian_ssm.inference import lgssm_filter
except ImportError:
    common.missing()

from space import dynamics, ensemble

z, H, shared = ensemble()
F, Q, R, mean, covariance = (jnp.asarray(x) for x in dynamics(H.shape[-1]))
model = LinearGaussianSSM(H.shape[-1], 1)
start, _ = model.initialize(
    initial_mean=mean,
    initial_covariance=covariance,
    dynamics_weights=F,
    dynamics_covariance=Q,
    emission_weights=jnp.ones((1, H.shape[-1])),
    emission_covariance=R,
)


def one(z, H):
    emissions = start.emissions._replace(weights=H[:, None, :])
    return lgssm_filter(start._replace(emissions=emissions), z[:, None]).marginal_loglik


@jax.jit
def total(z, H):
    return jax.vmap(one, in_axes=(0, None if shared else 0))(z, H).sum()


z, H = jnp.asarray(z), jnp.asarray(H)
value, run = common.repeated(lambda: total(z, H).block_until_ready())
common.say("dynamax", run, value)
