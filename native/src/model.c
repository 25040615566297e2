#include "model.h"

#include <math.h>
#include <stddef.h>
#include <stdio.h>
#include <string.h>

enum { FORMAT_VERSION = 2, LARGEST_SIZE = 65536, LONGEST_WINDOW = 512, LONGEST_GIVEN = 4096, MOST_LAYERS = 64 }; /* given to a predictor */
static const double LARGEST[3] = {1e5, 1e5, 1e4}; /* m/s2, mm/s and N that a card may speak of */
static const double LARGEST_SATURATION = 1e4;     /* standard deviations */

/* All that a card may say of a model's sizes, with what holds where it does not. */
typedef struct {
    net_sizes net;
    int model, excitation_width, order, n_speed, n_force, n_tones, n_tone_speed, n_tone_force, residual_order, n_residual_speed, n_residual_force;
    int excitation, gain_before_filter, residual_gain_before_filter, network_in_loop, condition_in_tokens;
    int ma, n_models, n_triangles, hops, hop, of_noise;
    double correction_limit;
} sizes;

enum { TEN = 1, FOTEN = 2, PLUS = 4, AR = 8, GRAPH = 16, NETWORKS = TEN | FOTEN | PLUS };

static const struct {
    const char *name;
    int bit, window; /* its usual one */
} MODELS[] = {{"foten-plus", PLUS, 20}, {"foten", FOTEN, 20}, {"ten", TEN, 25}, {"ar", AR, 21}};
static const struct {
    const char *name;
    int of_noise, hops;
} GRAPHS[] = {{"ten-mfcc", 0, 0}, {"ten-wavelet", 0, 0}, {"foten-d", 0, 0}, {"fnn", 0, 0}, {"dstn", 0, 0}, {"hapinf", 0, 0}, {"ldhtd", 0, 0},
              {"ldhtd-hop", 0, 1}, {"dftnet", 1, 0}, {"gan", 1, 0}};

static const struct {
    const char *name;
    int of; /* which models have it */
    size_t at;
    int usual, least;
} COUNTS[] = {
    {"window", NETWORKS | AR | GRAPH, offsetof(sizes, net.window), 0, 2},
    {"d_model", NETWORKS, offsetof(sizes, net.d_model), 32, 1},
    {"n_heads", NETWORKS, offsetof(sizes, net.n_heads), 4, 1},
    {"n_layers", NETWORKS, offsetof(sizes, net.n_layers), 3, 1},
    {"d_feedforward", NETWORKS, offsetof(sizes, net.d_feedforward), 128, 1},
    {"spectral_width", FOTEN | PLUS, offsetof(sizes, net.spectral_width), 32, 1},
    {"excitation_width", NETWORKS | GRAPH, offsetof(sizes, excitation_width), 16, 1},
    {"order", PLUS | AR, offsetof(sizes, order), 20, 1},
    {"n_speed", PLUS, offsetof(sizes, n_speed), 1, 1},
    {"n_force", PLUS, offsetof(sizes, n_force), 1, 1},
    {"n_tones", PLUS, offsetof(sizes, n_tones), 0, 0},
    {"n_tone_speed", PLUS, offsetof(sizes, n_tone_speed), 1, 1},
    {"n_tone_force", PLUS, offsetof(sizes, n_tone_force), 1, 1},
    {"residual_order", PLUS, offsetof(sizes, residual_order), 1, 1},
    {"n_residual_speed", PLUS, offsetof(sizes, n_residual_speed), 1, 1},
    {"n_residual_force", PLUS, offsetof(sizes, n_residual_force), 1, 1},
    {"ma", AR, offsetof(sizes, ma), 0, 0},
    {"n_models", AR, offsetof(sizes, n_models), 3, 3},
    {"n_triangles", AR, offsetof(sizes, n_triangles), 1, 1},
};

static const struct {
    const char *name;
    int of;
    size_t at;
    int usual;
} SWITCHES[] = {
    {"pre_norm", NETWORKS, offsetof(sizes, net.pre_norm), 1},
    {"excitation", TEN | FOTEN | GRAPH, offsetof(sizes, excitation), 0},
    {"condition_in_tokens", PLUS, offsetof(sizes, condition_in_tokens), 1},
    {"network_in_loop", PLUS, offsetof(sizes, network_in_loop), 1},
    {"gain_before_filter", PLUS, offsetof(sizes, gain_before_filter), 0},
    {"residual_gain_before_filter", PLUS, offsetof(sizes, residual_gain_before_filter), 0},
};

static const struct {
    const char *name;
    int of;
    size_t at;
    const char *values[3];
    int usual;
} CHOICES[] = {
    {"bins", FOTEN | PLUS, offsetof(sizes, net.half_bins), {"all", "half", NULL}, 0},
};

#define N(table) (int)(sizeof(table) / sizeof *(table))
#define FIELD(s, offset) (*(int *)(void *)((char *)(s) + (offset)))

static foten_status wrong_size(texture_file *file, const char *name) {
    return file_refuse(file, FOTEN_BAD_FILE, "'%s' among the sizes in the card is none that this library can run", name);
}

static foten_status read_sizes(texture_file *file, json from, int has_predictor, sizes *s) {
    json value;
    size_t n_known = 0;
    memset(s, 0, sizeof *s);
    json model = json_member(file->card, "model");
    long long usual_window = 0;
    for (int i = 0; i < N(MODELS); i++)
        if (json_is_string(model, MODELS[i].name)) {
            s->model = MODELS[i].bit;
            usual_window = MODELS[i].window;
        }
    for (int i = 0; i < N(GRAPHS); i++)
        if (json_is_string(model, GRAPHS[i].name)) {
            s->model = GRAPH;
            s->of_noise = GRAPHS[i].of_noise;
            s->hops = GRAPHS[i].hops;
        }
    if (!s->model)
        return file_refuse(file, FOTEN_BAD_FILE, "this library does not run the file's model, expected foten-plus, foten, ten or ar");
    if (s->model == GRAPH && !has_predictor)
        return file_refuse(file, FOTEN_NO_PREDICTOR, "the file's model is a graph that something else has to run, ONNX Runtime from Python for one: foten_model_load_with");
    int plus = s->model == PLUS;
    for (int i = 0; i < N(COUNTS); i++) {
        if (!(COUNTS[i].of & s->model)) continue;
        long long count = i ? COUNTS[i].usual : usual_window;
        value = json_member(from, COUNTS[i].name);
        n_known += value.begin != NULL;
        if (value.begin && !json_integer(value, &count)) return wrong_size(file, COUNTS[i].name);
        if (count < COUNTS[i].least || count > LARGEST_SIZE) return wrong_size(file, COUNTS[i].name);
        FIELD(s, COUNTS[i].at) = (int)count;
    }
    for (int i = 0; i < N(SWITCHES); i++) {
        if (!(SWITCHES[i].of & s->model)) continue;
        int on = SWITCHES[i].usual;
        value = json_member(from, SWITCHES[i].name);
        n_known += value.begin != NULL;
        if (value.begin && !json_boolean(value, &on)) return wrong_size(file, SWITCHES[i].name);
        FIELD(s, SWITCHES[i].at) = on;
    }
    for (int i = 0; i < N(CHOICES); i++) {
        if (!(CHOICES[i].of & s->model)) continue;
        int chosen = CHOICES[i].usual;
        value = json_member(from, CHOICES[i].name);
        n_known += value.begin != NULL;
        if (value.begin) {
            chosen = -1;
            for (int k = 0; k < 3; k++)
                if (CHOICES[i].values[k] && json_is_string(value, CHOICES[i].values[k])) chosen = k;
            if (chosen < 0) return wrong_size(file, CHOICES[i].name);
        }
        FIELD(s, CHOICES[i].at) = chosen;
    }
    value = s->model & NETWORKS ? json_member(from, "head") : (json){NULL, NULL};
    n_known += value.begin != NULL;
    s->net.first = 256;
    s->net.second = 64;
    if (value.begin) {
        long long widths[2];
        json item;
        const char *position = NULL;
        int n = 0;
        for (; json_next(value, &position, NULL, &item); n++)
            if (n == 2 || !json_integer(item, &widths[n]) || widths[n] < 1 || widths[n] > LARGEST_SIZE) return wrong_size(file, "head");
        if (n != 2) return wrong_size(file, "head");
        s->net.first = (int)widths[0];
        s->net.second = (int)widths[1];
    }
    s->correction_limit = 3;
    value = plus ? json_member(from, "correction_limit") : (json){NULL, NULL};
    n_known += value.begin != NULL;
    if (value.begin && (!json_number(value, &s->correction_limit) || !(s->correction_limit > 0 && s->correction_limit < 1e6)))
        return wrong_size(file, "correction_limit");
    if (s->model == GRAPH) {
        long long hop = 1;
        if (s->net.window > LONGEST_GIVEN || !s->net.window) return wrong_size(file, "window");
        if (s->of_noise && s->excitation) return wrong_size(file, "excitation");
        value = json_member(from, "hop");
        if (s->hops ? !json_integer(value, &hop) || hop < 1 || hop > s->net.window : value.begin != NULL) return wrong_size(file, "hop");
        s->hop = (int)hop;
        return FOTEN_OK;
    }
    if (s->model == PLUS) s->excitation = 1;
    if (json_count(from) != n_known)
        return file_refuse(file, FOTEN_BAD_FILE, "the card has a size that this library does not know; is the library older than the file?");
    net_sizes *n = &s->net;
    if (n->window > LONGEST_WINDOW) return wrong_size(file, "window");
    if (s->model == AR) {
        if (s->order > HIGHEST_LOCAL_ORDER) return wrong_size(file, "order");
        if (s->ma > HIGHEST_LOCAL_ORDER) return wrong_size(file, "ma");
        return n->window > s->order ? FOTEN_OK : wrong_size(file, "window");
    }
    if (n->n_layers > MOST_LAYERS) return wrong_size(file, "n_layers");
    if (n->d_model % n->n_heads || (n->spectral_width > 1 && n->spectral_width % n->n_heads)) return wrong_size(file, "n_heads");
    n->n_inputs = !plus ? 1 : s->condition_in_tokens ? 4 : 2;
    n->fourier = s->model != TEN;
    return FOTEN_OK;
}

static int numbers(json list, double *out, int n) {
    json item;
    const char *position = NULL;
    int found = 0;
    if (!list.begin || *list.begin != '[') return 0;
    for (; json_next(list, &position, NULL, &item); found++)
        if (found == n || !json_number(item, &out[found]) || !(fabs(out[found]) < 1e300)) return 0;
    return found == n;
}

static int text_of(json value, arena *memory, char **out) {
    if (!value.begin || *value.begin != '"') return 0;
    size_t room = (size_t)(value.end - value.begin);
    *out = arena_take(memory, room, 1);
    return *out && json_string(value, *out, room) >= 0;
}

static foten_status read_card(foten_model *m, texture_file *file, const sizes *s) {
    json card = file->card;
    long long window;
    if (!text_of(json_member(card, "model"), &m->memory, &m->name) || !text_of(json_member(card, "texture"), &m->memory, &m->texture))
        return m->memory.failed ? file_refuse(file, FOTEN_NO_MEMORY, "no memory") : file_refuse(file, FOTEN_BAD_FILE, "the card does not name a model and a texture");
    int most = s->order > s->residual_order ? s->order : s->residual_order;
    m->history = s->model == PLUS ? s->net.window + most + 1 : s->net.window;
    if (!json_integer(json_member(card, "window"), &window) || window != m->history)
        return file_refuse(file, FOTEN_BAD_FILE, "the card's window is not the network's %d", m->history);
    if (!json_number(json_member(card, "rate_hz"), &m->rate_hz) || !(m->rate_hz > 0 && m->rate_hz < 1e9))
        return file_refuse(file, FOTEN_BAD_FILE, "'rate_hz' in the card is not a positive number");
    if (!json_number(json_member(card, "lowpass_hz"), &m->lowpass_hz) || !(m->lowpass_hz > 0 && m->lowpass_hz < m->rate_hz / 2))
        return file_refuse(file, FOTEN_BAD_FILE, "'lowpass_hz' in the card is not between 0 and half of the rate");
    if (!json_number(json_member(card, "saturation"), &m->saturation) || !(m->saturation > 0 && m->saturation <= LARGEST_SATURATION))
        return file_refuse(file, FOTEN_BAD_FILE, "'saturation' in the card is not between 0 and %g standard deviations", LARGEST_SATURATION);
    json scaling = json_member(card, "scaling"), range = json_member(card, "trained_range"), beyond = json_member(card, "beyond_exponents");
    if (!numbers(json_member(scaling, "mean"), m->mean, 3) || !numbers(json_member(scaling, "sd"), m->sd, 3))
        return file_refuse(file, FOTEN_BAD_FILE, "the scaling in the card is not three means and three standard deviations");
    for (int i = 0; i < 3; i++)
        if (!(m->sd[i] > 0 && m->sd[i] <= LARGEST[i] && fabs(m->mean[i]) <= LARGEST[i]))
            return file_refuse(file, FOTEN_BAD_FILE, "the card's scaling is of no hand and no surface: a mean or standard deviation beyond %g, or none", LARGEST[i]);
    static const char *const channels[] = {"speed", "force"};
    for (int i = 0; i < 2; i++) {
        double ends[2];
        if (!numbers(json_member(range, channels[i]), ends, 2) || !(ends[0] >= 0 && ends[1] >= ends[0] && ends[1] <= LARGEST[1 + i]))
            return file_refuse(file, FOTEN_BAD_FILE, "the trained range of %s in the card is not [low, high]", channels[i]);
        m->low[i] = ends[0];
        m->high[i] = ends[1];
        if (!json_number(json_member(beyond, channels[i]), &m->exponents[i]) || !(m->exponents[i] >= 0 && m->exponents[i] <= 2))
            return file_refuse(file, FOTEN_BAD_FILE, "the exponent of %s beyond its range is not from 0 to 2", channels[i]);
    }
    return FOTEN_OK;
}

/* Each returns 0 where a tensor is not as it is to be; the file knows the reason. */
static const double *take(foten_model *m, texture_file *file, const char *prefix, const char *name, size_t rows, size_t columns) {
    char full[96];
    snprintf(full, sizeof full, "%s%s", prefix, name);
    size_t shape[4] = {rows, columns, 0, 0};
    return file_take(file, full, shape, &m->memory);
}

static int read_plane(foten_model *m, texture_file *file, const char *prefix, const char *values, int n_speed, int n_force, int width, plane *out) {
    *out = (plane){.n_speed = n_speed, .n_force = n_force, .width = width};
    if ((long long)n_speed * n_force > 1 << 28) {
        file_refuse(file, FOTEN_BAD_FILE, "the card has more vertices than can be");
        return 0;
    }
    out->speed_knots = take(m, file, prefix, "speed_knots", (size_t)n_speed, 0);
    out->force_knots = out->speed_knots ? take(m, file, prefix, "force_knots", (size_t)n_force, 0) : NULL;
    out->values = out->force_knots ? take(m, file, prefix, values, (size_t)n_speed * (size_t)n_force, (size_t)width) : NULL;
    if (!out->values) return 0;
    for (int i = 0; i < 2; i++) {
        const double *knots = i ? out->force_knots : out->speed_knots;
        for (int k = 1; k < (i ? n_force : n_speed); k++)
            if (!(knots[k] > knots[k - 1])) {
                file_refuse(file, FOTEN_BAD_FILE, "the knots of speed or force do not rise");
                return 0;
            }
    }
    return 1;
}

static int read_scale(foten_model *m, texture_file *file, const char *prefix, int width, scale *out) {
    const double *bias, *highest, *mean, *sd, *floor;
    out->width = width;
    if (!(out->hidden = take(m, file, prefix, "hidden.weight", (size_t)width, 4))) return 0;
    if (!(out->hidden_bias = take(m, file, prefix, "hidden.bias", (size_t)width, 0))) return 0;
    if (!(out->out = take(m, file, prefix, "out.weight", 1, (size_t)width))) return 0;
    if (!(bias = take(m, file, prefix, "out.bias", 1, 0))) return 0;
    if (!(out->power_law = take(m, file, prefix, "power_law.weight", 1, 5))) return 0;
    if (!(highest = take(m, file, prefix, "highest", 1, 0))) return 0;
    if (!(mean = take(m, file, prefix, "mean", 2, 0)) || !(sd = take(m, file, prefix, "sd", 2, 0))) return 0;
    if (!(floor = take(m, file, prefix, "floor", 2, 0))) return 0;
    out->out_bias = *bias;
    out->highest = *highest;
    if (!(*highest > 0)) {
        file_refuse(file, FOTEN_BAD_FILE, "tensor '%shighest' is not positive", prefix);
        return 0;
    }
    for (int i = 0; i < 2; i++) {
        out->mean[i] = mean[i];
        out->sd[i] = sd[i];
        out->floor[i] = floor[i];
        if (!(floor[i] > 0 && mean[i] + floor[i] > 0)) {
            file_refuse(file, FOTEN_BAD_FILE, "tensor '%sfloor' is not positive", prefix);
            return 0;
        }
    }
    return 1;
}

static int read_lattice(foten_model *m, texture_file *file, const char *prefix, int n_speed, int n_force, int order, int width, int before,
                        lattice *out) {
    char level[64];
    snprintf(level, sizeof level, "%slevel.", prefix);
    out->order = order;
    out->gain_before_filter = before;
    if (!read_plane(m, file, prefix, "reflections", n_speed, n_force, order, &out->reflections)) return 0;
    for (size_t i = 0; i < (size_t)n_speed * (size_t)n_force * (size_t)order; i++)
        if (!(fabs(out->reflections.values[i]) < 1)) {
            file_refuse(file, FOTEN_BAD_FILE, "a reflection is %g in size, expected less than 1: the lattice would not be stable",
                        fabs(out->reflections.values[i]));
            return 0;
        }
    return read_scale(m, file, level, width, &out->level);
}

static int read_excitation(foten_model *m, texture_file *file, const sizes *s) {
    const double *found;
    if (!read_scale(m, file, "excitation.", s->excitation_width, &m->sigma)) return 0;
    if (!(found = take(m, file, "excitation.", "tail.weight", 1, 5))) return 0;
    memcpy(m->tail, found, sizeof m->tail);
    if (!(found = take(m, file, "excitation.", "tail.bias", 1, 0))) return 0;
    m->tail_bias = *found;
    if (!(found = take(m, file, "excitation.", "largest", 2, 0))) return 0;
    memcpy(m->largest, found, sizeof m->largest);
    if (!(m->largest[0] >= 0 && m->largest[1] >= 0)) {
        file_refuse(file, FOTEN_BAD_FILE, "tensor 'excitation.largest' is negative");
        return 0;
    }
    if (!(found = take(m, file, "excitation.", "volatility", 2, 0))) return 0;
    m->swell_kept = found[0];
    m->swell_sd = found[1];
    if (!(m->swell_kept >= 0 && m->swell_kept <= 1 && m->swell_sd >= 0)) {
        file_refuse(file, FOTEN_BAD_FILE, "tensor 'excitation.volatility' is out of range");
        return 0;
    }
    return 1;
}

static int read_plus(foten_model *m, texture_file *file, const sizes *s) {
    const double *found;
    int width = s->excitation_width;
    m->plus = 1;
    m->network_in_loop = s->network_in_loop && !s->n_tones;
    m->correction_limit = s->correction_limit;
    if (!read_lattice(m, file, "lattice.", s->n_speed, s->n_force, s->order, width, s->gain_before_filter, &m->whole)) return 0;
    m->residual = m->whole;
    m->n_tones = s->n_tones;
    if (s->n_tones) {
        if (!read_plane(m, file, "tones.", "values", s->n_tone_speed, s->n_tone_force, 2 * s->n_tones, &m->tones)) return 0;
        if (!(found = take(m, file, "tones.", "motion", 3, 0))) return 0;
        m->turn = found[0];
        m->unevenness = found[1];
        m->forgetting = found[2];
        if (!(m->turn >= 0 && fabs(m->unevenness) <= 10 && m->forgetting >= 0 && m->forgetting <= 1)) {
            file_refuse(file, FOTEN_BAD_FILE, "tensor 'tones.motion' is out of range");
            return 0;
        }
        if (!read_lattice(m, file, "residual.", s->n_residual_speed, s->n_residual_force, s->residual_order, width, s->residual_gain_before_filter, &m->residual)) return 0;
    }
    return 1;
}

foten_status model_read(foten_model *m, texture_file *file, const isa *isa) {
    sizes s;
    long long version;
    if (!json_integer(json_member(file->card, "format_version"), &version))
        return file_refuse(file, FOTEN_BAD_FILE, "the card has no format version");
    if (version != FORMAT_VERSION)
        return file_refuse(file, FOTEN_BAD_FILE, "the file has format version %lld, expected %d: %s", version, FORMAT_VERSION,
                           version < FORMAT_VERSION ? "train it again with this foten" : "update foten");
    json from = json_member(file->card, "sizes");
    if (!from.begin || *from.begin != '{') return file_refuse(file, FOTEN_BAD_FILE, "the card has no 'sizes'");
    foten_status status = read_sizes(file, from, m->predictor != NULL, &s);
    if (status == FOTEN_OK) status = read_card(m, file, &s);
    if (status != FOTEN_OK) return status;
    m->isa = isa;
    if (s.model != GRAPH) m->predictor = NULL;
    int plus = s.model == PLUS;
    m->excited = s.excitation || s.model == AR;
    if (s.model == AR) {
        m->local = local_make(file, s.order, s.ma, s.n_models, s.n_triangles, &m->memory);
        return m->local ? FOTEN_OK : file_refuse(file, m->memory.failed ? FOTEN_NO_MEMORY : FOTEN_BAD_FILE, "no memory");
    }
    if (plus && !read_plus(m, file, &s)) return m->memory.failed ? FOTEN_NO_MEMORY : FOTEN_BAD_FILE;
    if (s.excitation && !read_excitation(m, file, &s)) return m->memory.failed ? FOTEN_NO_MEMORY : FOTEN_BAD_FILE;
    m->n_inputs = s.model == GRAPH ? 3 : s.net.n_inputs;
    m->of_noise = s.of_noise;
    m->hop = s.model == GRAPH ? s.hop : 0;
    if (s.model == GRAPH) {
        file_leave(file, "graph");
        return FOTEN_OK;
    }
    m->network = net_make(file, plus ? "network." : "", &s.net, isa, &m->memory);
    if (!m->network) return file_refuse(file, m->memory.failed ? FOTEN_NO_MEMORY : FOTEN_BAD_FILE, "no memory");
    return FOTEN_OK;
}

/* The knot at or below which a value lies, and its share of the next one. */
static int knot_at(const double *knots, int n, double value, double *share) {
    *share = 0;
    if (n == 1 || value <= knots[0]) return 0;
    if (value >= knots[n - 1]) {
        *share = 1;
        return n - 2;
    }
    int low = 0, high = n - 1;
    while (high - low > 1) {
        int middle = (low + high) / 2;
        if (knots[middle] <= value) low = middle;
        else high = middle;
    }
    *share = (value - knots[low]) / (knots[low + 1] - knots[low]);
    return low;
}

void plane_at(const plane *p, double speed, double force, double *out) {
    double over_speed, over_force;
    int i = knot_at(p->speed_knots, p->n_speed, speed, &over_speed);
    int j = knot_at(p->force_knots, p->n_force, log((force > 0 ? force : 0) + 0.05), &over_force);
    size_t width = (size_t)p->width, row = (size_t)p->n_force * width;
    const double *a = p->values + (size_t)i * row + (size_t)j * width, *b = p->n_force > 1 ? a + width : a;
    const double *c = p->n_speed > 1 ? a + row : a, *d = p->n_speed > 1 ? b + row : b;
    double wa = (1 - over_speed) * (1 - over_force), wb = (1 - over_speed) * over_force;
    double wc = over_speed * (1 - over_force), wd = over_speed * over_force;
    if (p->n_speed * p->n_force == 1)
        for (size_t k = 0; k < width; k++) out[k] = a[k];
    else
        for (size_t k = 0; k < width; k++) out[k] = wa * a[k] + wb * b[k] + wc * c[k] + wd * d[k];
}

void physical_of(const scale *s, const double condition[2], double out[2]) {
    for (int i = 0; i < 2; i++) {
        double x = condition[i] * s->sd[i] + s->mean[i];
        out[i] = x > 0 ? x : 0;
    }
}

void powers_of(const double logs[2], double out[5]) {
    out[0] = logs[0];
    out[1] = logs[1];
    out[2] = logs[0] * logs[0];
    out[3] = logs[0] * logs[1];
    out[4] = logs[1] * logs[1];
}

double scale_at(const scale *s, const double condition[2], double logs[2]) {
    double physical[2], powers[5];
    physical_of(s, condition, physical);
    for (int i = 0; i < 2; i++) logs[i] = log((physical[i] + s->floor[i]) / (s->mean[i] + s->floor[i]));
    powers_of(logs, powers);
    double found = s->out_bias;
    for (int k = 0; k < 5; k++) found += s->power_law[k] * powers[k];
    for (int h = 0; h < s->width; h++) {
        const double *w = s->hidden + 4 * h;
        found += s->out[h] * tanh(s->hidden_bias[h] + w[0] * condition[0] + w[1] * condition[1] + w[2] * logs[0] + w[3] * logs[1]);
    }
    found = exp(found);
    return found < s->highest ? found : s->highest;
}
