/* Robot {{ robot }}: feed-forward torque, payload and model errors, one sample every {{ "%g" % (period * 1e6) }} us.
 * Effects: {{ effects }}. Made by deltatwin {{ version }}, `deltatwin export --to c`; do not edit.
{% if single %}
 * {{ single }}.
{% endif %}
 * Compile with -ffp-contract=off and without -ffast-math, for the same bits as the service. */
#ifndef {{ macro }}_H
#define {{ macro }}_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* What functions return. */
#define {{ macro }}_OK (0)
#define {{ macro }}_NOTHING (1)       /* of a look back: samples do not reach back to it yet */
#define {{ macro }}_NOT_READY (-1)    /* no init before, or one that failed: every answer is zero */
#define {{ macro }}_WRONG_PERIOD (-2) /* of init: made for another cycle */
#define {{ macro }}_NO_ARGUMENT (-3)  /* a null pointer */
#define {{ macro }}_OUT_OF_RANGE (-4) /* of load: a figure that no robot has; all stay as they were */
#define {{ macro }}_NOT_FINITE (-5)   /* the answer was no number, and is zero; init again */

#define {{ macro }}_PERIOD {{ period_literal }} /* s */

{% for message in messages %}
{% for constant in message.constants %}
#define {{ macro }}_{{ constant.name }} {{ constant.value }}U{{ constant.comment }}
{% endfor %}
/* {{ message.about }} */
typedef struct {
{% for field in message.fields %}
    {{ field.declared }};{{ field.comment }}
{% endfor %}
} {{ name }}_{{ message.topic }};

{% endfor %}
/* Bits of what findings return. */
{% for flag in health %}
#define {{ macro }}_{{ flag.name }} {{ flag.value }} /* {{ flag.comment }} */
{% endfor %}

/* Figures that may be loaded while the controller runs; all others are constants. */
typedef struct {
{% for one in loadable %}
    {{ one.declared }}; /* {{ one.unit }}, {{ one.meaning }}; {{ one.low }} to {{ one.high }} */
{% endfor %}
} {{ name }}_parameters;

/* Which code this is: of twin.json beside it. */
uint64_t {{ name }}_id(void);
/* Begin: nothing is seen yet, and nothing known of payload and changed friction. period_s: of the controller's cycle. */
int {{ name }}_init(double period_s);
/* A sample in which nothing is said, to be filled with what is known: stamp, sequence, positions and torques at least. */
void {{ name }}_clear({{ name }}_sample *sample);
/* Once a cycle: one sample in, the torque for the drives out. */
int {{ name }}_step(const {{ name }}_sample *sample, {{ name }}_feedforward *answer);
/* After a step, when the drives have their torque: payload and errors a fixed lag ago. Left out, the next step does it
 * first. */
int {{ name }}_look_back({{ name }}_payload *payload, {{ name }}_error *error);
/* About once a second: how far friction is from the identified one. Returns bits, or a code below zero. */
int {{ name }}_findings({{ name }}_friction *friction);
/* The planned motion of a coming cycle: while it lies ahead, the torque is for it. */
int {{ name }}_plan(const {{ name }}_reference *reference);
/* The figures of now. */
void {{ name }}_parameters_now({{ name }}_parameters *parameters);
/* At a standstill: take other figures and begin anew. If one is out of range, all stay as they were. */
int {{ name }}_load(const {{ name }}_parameters *parameters);

#ifdef __cplusplus
}
#endif

#endif /* {{ macro }}_H */
