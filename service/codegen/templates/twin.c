/* Robot {{ robot }}: see {{ name }}.h. Made by deltatwin {{ version }}, `deltatwin export --to c`; do not edit. */
#include "{{ name }}.h"

#include <math.h>

/* For who tests: what must hold. */
#ifndef CHECK
#define CHECK(condition) ((void)0)
#endif

#ifdef __GNUC__
#define UNROLLED _Pragma("GCC unroll {{ unrolled }}")
#else
#define UNROLLED
#endif

{{ definitions }}
static const {{ settings }} described = {
{{ described }}
};

static {{ step }} it;
static bool is_ready = false;
static bool is_behind = false; /* a look back is due */

static void begin(void)
{
    unsigned char *bytes = (unsigned char *)&it.state;
    for (uint64_t n = 0; n < sizeof it.state; n++) {
        bytes[n] = 0;
    }
{% for place, value in beginning %}
    {{ place }} = {{ value }};
{% endfor %}
    is_behind = false;
}

{% for topic, fields in answers.items() %}
static void zero_{{ topic }}({{ name }}_{{ topic }} *answer)
{
{% for field in fields %}
    {{ field }}
{% endfor %}
}

{% endfor %}
uint64_t {{ name }}_id(void)
{
    return {{ id }};
}

int {{ name }}_init(double period_s)
{
    is_ready = fabs((period_s / {{ macro }}_PERIOD) - 1.0) <= {{ same_period }};
    it.settings = described;
    begin();
    return is_ready ? {{ macro }}_OK : {{ macro }}_WRONG_PERIOD;
}

void {{ name }}_clear({{ name }}_sample *sample)
{
{% for field in cleared %}
    {{ field }}
{% endfor %}
}

int {{ name }}_step(const {{ name }}_sample *sample, {{ name }}_feedforward *answer)
{
    if (answer == 0) {
        return {{ macro }}_NO_ARGUMENT;
    }
    if (!is_ready || (sample == 0)) {
        zero_feedforward(answer);
        return is_ready ? {{ macro }}_NO_ARGUMENT : {{ macro }}_NOT_READY;
    }
    if (is_behind) {
        (void){{ roots.look_back }}(&it);
    }
    it.sample = *sample;
    is_behind = {{ roots.answer }}(&it).part_1;
    *answer = it.feedforward;
    for (int64_t i = 0; i < 3; i++) {
        if (!isfinite(answer->torque[i])) {
            zero_feedforward(answer);
            is_ready = false;
            return {{ macro }}_NOT_FINITE;
        }
    }
    return {{ macro }}_OK;
}

int {{ name }}_look_back({{ name }}_payload *payload, {{ name }}_error *error)
{
    if ((payload == 0) || (error == 0)) {
        return {{ macro }}_NO_ARGUMENT;
    }
    if (!is_ready || !is_behind) {
        zero_payload(payload);
        zero_error(error);
        return is_ready ? {{ macro }}_NOTHING : {{ macro }}_NOT_READY;
    }
    is_behind = false;
    (void){{ roots.look_back }}(&it);
    *payload = it.payload;
    *error = it.error;
    return {{ macro }}_OK;
}

int {{ name }}_findings({{ name }}_friction *friction)
{
    int64_t flags = 0;
    if (friction == 0) {
        return {{ macro }}_NO_ARGUMENT;
    }
    if (!is_ready) {
        zero_friction(friction);
        return {{ macro }}_NOT_READY;
    }
    flags = {{ roots.findings }}(&it);
    *friction = it.friction;
    return (int)flags;
}

int {{ name }}_plan(const {{ name }}_reference *reference)
{
    if (reference == 0) {
        return {{ macro }}_NO_ARGUMENT;
    }
    if (!is_ready) {
        return {{ macro }}_NOT_READY;
    }
    it.reference = *reference;
    {{ roots.plan }}(&it);
    return {{ macro }}_OK;
}

void {{ name }}_parameters_now({{ name }}_parameters *parameters)
{
    if (!is_ready) {
        it.settings = described;
    }
{% for one in loadable %}
{% for axis in one.axes %}
    for (int64_t {{ axis.name }} = 0; {{ axis.name }} < {{ axis.count }}; {{ axis.name }}++) {
{% endfor %}
        parameters->{{ one.name }}{{ one.index }} = it.settings.{{ one.name }}{{ one.index }};
{% for axis in one.axes %}
    }
{% endfor %}
{% endfor %}
}

int {{ name }}_load(const {{ name }}_parameters *parameters)
{
    if (parameters == 0) {
        return {{ macro }}_NO_ARGUMENT;
    }
    if (!is_ready) {
        return {{ macro }}_NOT_READY;
    }
{% for one in loadable %}
{% for axis in one.axes %}
    for (int64_t {{ axis.name }} = 0; {{ axis.name }} < {{ axis.count }}; {{ axis.name }}++) {
{% endfor %}
        /* also when it is no number */
        if (!((parameters->{{ one.name }}{{ one.index }} >= {{ one.low }}) && (parameters->{{ one.name }}{{ one.index }} <= {{ one.high }}))) {
            return {{ macro }}_OUT_OF_RANGE;
        }
{% for axis in one.axes %}
    }
{% endfor %}
{% endfor %}
{% for one in loadable %}
{% for axis in one.axes %}
    for (int64_t {{ axis.name }} = 0; {{ axis.name }} < {{ axis.count }}; {{ axis.name }}++) {
{% endfor %}
        it.settings.{{ one.name }}{{ one.index }} = parameters->{{ one.name }}{{ one.index }};
{% for axis in one.axes %}
    }
{% endfor %}
{% endfor %}
    it.settings.growth = {{ growth_share }} * it.settings.slope;
    begin();
    return {{ macro }}_OK;
}
