/* Robot {{ robot }}: feed-forward torque, payload and model errors, one sample every {{ "%g" % (period * 1e6) }} us.
 * Effects: {{ effects }}. Made by deltatwin {{ version }}, `deltatwin export --to c`; do not edit.
{% if single %}
 * {{ single }}.
{% endif %}
 * Static memory: {{ static_bytes }} bytes, with a look back of {{ looked_back }} samples; no heap.
 * Compile with -ffp-contract=off and without -ffast-math, for the same bits as the service. */
#ifndef {{ macro }}_H
#define {{ macro }}_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Return codes. */
#define {{ macro }}_OK (0)
#define {{ macro }}_NOTHING (1)       /* look back: not enough samples yet */
#define {{ macro }}_NOT_READY (-1)    /* init was not called or failed: every answer is zero */
#define {{ macro }}_WRONG_PERIOD (-2) /* init: the code was made for another cycle */
#define {{ macro }}_NO_ARGUMENT (-3)  /* a null pointer */
#define {{ macro }}_OUT_OF_RANGE (-4) /* load: a parameter is out of range; nothing was loaded */
#define {{ macro }}_NOT_FINITE (-5)   /* the answer was not a number and was set to zero; call init again */

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
/* Bits returned by findings. */
{% for flag in health %}
#define {{ macro }}_{{ flag.name }} {{ flag.value }} /* {{ flag.comment }} */
{% endfor %}

/* Parameters that may be loaded while the controller runs; all others are constants. */
typedef struct {
{% for one in loadable %}
    {{ one.declared }}; /* {{ one.unit }}, {{ one.meaning }}; {{ one.low }} to {{ one.high }} */
{% endfor %}
} {{ name }}_parameters;

/* Identifier of this code, as in twin.json next to it. */
uint64_t {{ name }}_id(void);
/* Start without history: payload and drift of friction are unknown. period_s: of the controller's cycle. */
int {{ name }}_init(double period_s);
/* An empty sample. Fill in at least stamp, sequence, positions and torques. */
void {{ name }}_clear({{ name }}_sample *sample);
/* Once per cycle: takes one sample, gives the torque for the drives. */
int {{ name }}_step(const {{ name }}_sample *sample, {{ name }}_feedforward *answer);
/* After a step, when the drives have their torque: payload and errors a fixed lag ago. If it is not called, the next
 * step does its work first. */
int {{ name }}_look_back({{ name }}_payload *payload, {{ name }}_error *error);
/* About once a second: drift of friction from the identified values. Returns bits, or a code below zero. */
int {{ name }}_findings({{ name }}_friction *friction);
/* The planned motion of a coming cycle: the torque is for it as long as it is ahead. */
int {{ name }}_plan(const {{ name }}_reference *reference);
/* The present parameters. */
void {{ name }}_parameters_now({{ name }}_parameters *parameters);
/* At a standstill: load other parameters and start again. If one is out of range, nothing is loaded. */
int {{ name }}_load(const {{ name }}_parameters *parameters);

#ifdef __cplusplus
}
#endif

#endif /* {{ macro }}_H */
