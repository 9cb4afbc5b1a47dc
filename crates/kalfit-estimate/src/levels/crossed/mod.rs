//! Tests whose groups cross: units that meet several stations, on several days (theory §16).
//!
//! Test j of unit u, with level l_f(j) of each factor f, has ξ_j = X_jβ + a_u + Σ_f b_f,l + γ_j, all effects independent;
//! E_j (p × M) selects the effects b that test j takes part in: of one level of each factor or, where two instruments
//! are in one test, of several ([`member`]). The effect of the test is integrated out as in
//! [`levels`](super), which leaves (W_j, s_j). A group with J = ΣW, y = Σs and D = ΣWE over its members is eliminated by
//!
//! ```text
//! H = L(I+L'JL)⁻¹L'      T = I - HJ      W = T'J      s = T'y      T'D
//! ```
//!
//! and what is left is one system over all effects that cross, b = Lv:
//!
//! ```text
//! K = Σ E'WE - Σ D'HD      y = Σ E's - Σ D'Hy      C = L(I+L'KL)⁻¹L' = Var[b | z]      b̂ = Cy            (A2), (A3)
//! A_u | b = α_u - Γ_u b ± P_u     from the unit to its inner groups: α = Tα + Hy, Γ = TΓ + HD, P = TPT' + H
//! m̂_j = α_u + (E_j-Γ_u)b̂      V_j = P_u + (E_j-Γ_u)C(E_j-Γ_u)'      r_j = s_j - W_jm̂_j      N_j = W_j - W_jV_jW_j  (A4)
//! ```
//!
//! Units that share no level with others form parts of their own ([`layout`]), each a small system. What depends on Σ
//! alone is computed first ([`eliminated`], [`dense`], [`weights`]), then what depends on data ([`respond`]); a data
//! column is d - Rμ, the effect of a mean coordinate, or a working vector V̇_D P z of a direction D of Σ, whose response
//! is -∂(Pz). The derivatives of N along D ([`tangents`]) and these responses are the second derivatives ([`totals`]).

mod dense;
mod eliminated;
mod layout;
mod member;
mod posterior;
mod respond;
mod tangents;
mod totals;
mod weights;

pub(super) use layout::Crossing;
pub(super) use posterior::posteriors;
pub(super) use totals::{each_part, pass};
