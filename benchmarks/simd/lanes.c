/* The peer of the fused stepper: eight snakeboards at once in AVX-512, adaptive Tsit5, one core.
 *
 * Structure `free`, Pacejka tyre, steering and rotor each one tracked sine; the same equations, method, error norm and
 * step control as snakejax, with what a hand can save saved: constants of a lane computed once, the decay of the
 * controller shared by both joints, the rotor's acceleration alone. Eight lanes step together until all have arrived.
 *
 *   cc -O3 -march=native -ffast-math -shared -fPIC -o lanes.so lanes.c -lm -lmvec
 */
#include <immintrin.h>

typedef double v8 __attribute__((vector_size(64)));
typedef long long m8 __attribute__((vector_size(64)));

v8 _ZGVeN8v_sin(v8);
v8 _ZGVeN8v_cos(v8);
v8 _ZGVeN8v_atan(v8);
v8 _ZGVeN8v_exp(v8);
#define SIN _ZGVeN8v_sin
#define COS _ZGVeN8v_cos
#define ATAN _ZGVeN8v_atan
#define EXP _ZGVeN8v_exp

/* Rows of `lanes`, one number a lane each. */
enum { MASS, INERTIA, ROTOR, LENGTH, CREEP, B_, C_, D_, E_, AS, WS, PS, AR, WR, PR, KP, KD, X0, Y0, H0, ROWS };

static inline v8 splat(double x) { return (v8){x, x, x, x, x, x, x, x}; }
static inline v8 pick(m8 mask, v8 yes, v8 no) { return (v8)((mask & (m8)yes) | (~mask & (m8)no)); }
static inline v8 root(v8 x) { return (v8)_mm512_sqrt_pd((__m512d)x); }
static inline v8 least(v8 a, v8 b) { return pick(a < b, a, b); }
static inline v8 most(v8 a, v8 b) { return pick(a > b, a, b); }
static inline v8 size(v8 x) { return most(x, -x); }
static inline int any(m8 mask) {
    long long all = 0;
    for (int i = 0; i < 8; i++) all |= mask[i];
    return all != 0;
}

typedef struct {
    v8 mass, inertia, rotor, length, creep, B, C, D, E, as, ws, ps, ar, wr, pr, kp, kd, a, q, s_e0, s_slope, r_e0, r_slope;
} Lane;

static inline v8 force(const Lane *p, v8 v, v8 roll) {
    v8 square = roll * roll + p->creep * p->creep;
    v8 slip = 2 * ATAN(v / (root(square) + root(square + v * v)));
    v8 eta = (1 - p->E) * slip + p->E / p->B * ATAN(p->B * slip);
    return p->D * SIN(p->C * ATAN(p->B * eta));
}

static inline void rates(const Lane *p, v8 t, const v8 y[6], v8 d[6]) {
    v8 fade = EXP(-p->a * t), c = COS(p->q * t), s = SIN(p->q * t) / p->q, q2 = p->q * p->q;
    v8 e = fade * (p->s_e0 * c + p->s_slope * s);
    v8 phi = p->as * SIN(p->ws * t + p->ps) + e;
    v8 f = fade * (p->r_e0 * c + p->r_slope * s);
    v8 f_rate = fade * (p->r_slope * c - q2 * p->r_e0 * s) - p->a * f;
    v8 psi2 = -p->ar * p->wr * p->wr * SIN(p->wr * t + p->pr) - p->kd * f_rate - p->kp * f;
    v8 sine = SIN(phi), cosine = COS(phi), u = y[3], w = y[4], r = y[5];
    v8 front = w + p->length * r, back = w - p->length * r;
    v8 Ff = force(p, -u * sine + front * cosine, u * cosine + front * sine);
    v8 Fb = force(p, u * sine + back * cosine, u * cosine - back * sine);
    v8 X = (Ff - Fb) * sine, Yf = -Ff * cosine, Yb = -Fb * cosine;
    v8 along = COS(y[2]), across = SIN(y[2]);
    d[0] = u * along - w * across;
    d[1] = u * across + w * along;
    d[2] = r;
    d[3] = X / p->mass + r * w;
    d[4] = (Yf + Yb) / p->mass - r * u;
    d[5] = (p->length * (Yf - Yb) - p->rotor * psi2) / p->inertia;
}

/* Tsitouras 2011; `a` has six rows, the last of them the solution, `e` the error weights. */
static void eight(const double *lanes, long count, long at, const double *a, const double *nodes, const double *e,
                  double until, double rtol, double atol, double *poses, long *steps) {
    Lane p;
    v8 row[ROWS], zero = splat(0), y[6], next[6], k[7][6];
    for (int j = 0; j < ROWS; j++)
        for (int i = 0; i < 8; i++) row[j][i] = lanes[j * count + (at + i < count ? at + i : count - 1)];
    p.mass = row[MASS], p.inertia = row[INERTIA], p.rotor = row[ROTOR], p.length = row[LENGTH], p.creep = row[CREEP];
    p.B = row[B_], p.C = row[C_], p.D = row[D_], p.E = row[E_], p.as = row[AS], p.ws = row[WS], p.ps = row[PS];
    p.ar = row[AR], p.wr = row[WR], p.pr = row[PR], p.kp = row[KP], p.kd = row[KD];
    p.a = p.kd / 2, p.q = root(p.kp - p.a * p.a);
    p.s_e0 = -p.as * SIN(p.ps), p.s_slope = -p.as * p.ws * COS(p.ps) + p.a * p.s_e0;
    p.r_e0 = -p.ar * SIN(p.pr), p.r_slope = -p.ar * p.wr * COS(p.pr) + p.a * p.r_e0;
    y[0] = row[X0], y[1] = row[Y0], y[2] = row[H0], y[3] = y[4] = y[5] = zero;
    v8 t = zero, h_next = splat(1e-3), target = splat(until);
    rates(&p, t, y, k[0]);
    while (any(t < target)) {
        v8 left = target - t;
        m8 last = h_next >= left, here = left > zero;
        v8 h = pick(last, left, pick(2 * h_next > left, 0.5 * left, h_next));
        for (int stage = 0; stage < 6; stage++) {
            for (int i = 0; i < 6; i++) {
                v8 sum = zero;
                for (int j = 0; j <= stage; j++) sum += a[6 * stage + j] * k[j][i];
                next[i] = y[i] + h * sum;
            }
            rates(&p, t + nodes[stage] * h, next, k[stage + 1]);
        }
        v8 square = zero;
        for (int i = 0; i < 6; i++) {
            v8 sum = zero, scale = atol + rtol * most(size(y[i]), size(next[i]));
            for (int j = 0; j < 7; j++) sum += e[j] * k[j][i];
            sum = h * sum / scale;
            square += sum * sum;
        }
        square = square / 6;
        m8 good = square <= splat(1);
        v8 factor = 0.8 / root(root(root(root(most(square, splat(1e-30))))));
        factor = least(most(factor, splat(0.2)), splat(5));
        v8 grown = h * factor, wanted = pick(good & (h < h_next), most(grown, h_next), grown);
        m8 go = good & here;
        t = pick(go, pick(last, target, t + h), t);
        for (int i = 0; i < 6; i++) y[i] = pick(go, next[i], y[i]), k[0][i] = pick(go, k[6][i], k[0][i]);
        h_next = pick(here, wanted, h_next);
        *steps += 8;
    }
    for (int i = 0; i < 8 && at + i < count; i++)
        for (int j = 0; j < 3; j++) poses[3 * (at + i) + j] = y[j][i];
}

/* `lanes` (ROWS, count) -> `poses` (count, 3) at time `until`; gives the steps taken by all lanes. */
long integrate(const double *lanes, long count, const double *a, const double *nodes, const double *e, double until,
               double rtol, double atol, double *poses) {
    long steps = 0;
    for (long at = 0; at < count; at += 8) eight(lanes, count, at, a, nodes, e, until, rtol, atol, poses, &steps);
    return steps;
}
