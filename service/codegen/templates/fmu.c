/* The twin as an FMU of FMI {{ fmi }}.0 for co-simulation: one instance per process, one step per sample. */
#include "{{ name }}.h"

#include <math.h>
#include <stddef.h>

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

enum { OK = 0, FAILED = 3 };

static {{ name }}_sample sample;
static {{ name }}_feedforward answer;
static {{ name }}_payload payload;
static {{ name }}_error error;
static {{ name }}_parameters parameters;
static double now = 0.0;
static bool is_taken = false;

static double *real_of(uint32_t reference)
{
    switch (reference) {
{% for one in variables if one.is_real %}
    case {{ one.reference }}U: return &{{ one.place }};
{% endfor %}
    default: return 0;
    }
}

static int get_whole(uint32_t reference, int32_t *value)
{
    switch (reference) {
{% for one in variables if not one.is_real %}
    case {{ one.reference }}U: *value = (int32_t){{ one.place }}; return OK;
{% endfor %}
    default: return FAILED;
    }
}

static int set_whole(uint32_t reference, int32_t value)
{
    switch (reference) {
{% for one in variables if not one.is_real and one.causality == "input" %}
    case {{ one.reference }}U: {{ one.place }} = (uint32_t)value; return OK;
{% endfor %}
    default: return FAILED;
    }
}

static int begin(void)
{
    {{ name }}_clear(&sample);
    const int made = {{ name }}_init({{ macro }}_PERIOD);
    {{ name }}_parameters_now(&parameters);
    (void){{ name }}_look_back(&payload, &error);
    answer.source = {{ macro }}_SOURCE_NONE;
    for (int i = 0; i < 3; i++) {
        answer.torque[i] = 0.0;
    }
    now = 0.0;
    return (made == {{ macro }}_OK) ? OK : FAILED;
}

static int step(double time, double length)
{
    {{ name }}_payload mass;
    {{ name }}_error left;
    if (!(fabs((length / {{ macro }}_PERIOD) - 1.0) <= 1e-3)) {
        return FAILED;
    }
    sample.stamp_sec = (int32_t)floor(time);
    sample.stamp_nanosec = (uint32_t)rint((time - floor(time)) * 1e9) % 1000000000U;
    if ({{ name }}_step(&sample, &answer) != {{ macro }}_OK) {
        return FAILED;
    }
    sample.sequence++;
    if ({{ name }}_look_back(&mass, &left) == {{ macro }}_OK) {
        payload = mass;
        error = left;
    }
    now = time + length;
    return OK;
}

static int get_reals(const uint32_t *references, size_t count, double *values)
{
    for (size_t n = 0; n < count; n++) {
        const double *place = (references[n] == {{ time_reference }}U) ? &now : real_of(references[n]);
        if (place == 0) {
            return FAILED;
        }
        values[n] = *place;
    }
    return OK;
}

static int set_reals(const uint32_t *references, size_t count, const double *values)
{
    for (size_t n = 0; n < count; n++) {
        double *place = (references[n] < {{ settable }}U) ? real_of(references[n]) : 0;
        if (place == 0) {
            return FAILED;
        }
        *place = values[n];
    }
    return OK;
}

static int get_wholes(const uint32_t *references, size_t count, int32_t *values)
{
    int told = OK;
    for (size_t n = 0; (n < count) && (told == OK); n++) {
        told = get_whole(references[n], &values[n]);
    }
    return told;
}

static int set_wholes(const uint32_t *references, size_t count, const int32_t *values)
{
    int told = OK;
    for (size_t n = 0; (n < count) && (told == OK); n++) {
        told = set_whole(references[n], values[n]);
    }
    return told;
}

static void *take(void)
{
    if (is_taken || (begin() != OK)) {
        return 0;
    }
    is_taken = true;
    return &sample;
}

static int loaded(void)
{
    return ({{ name }}_load(&parameters) == {{ macro }}_OK) ? OK : FAILED;
}

#define NOT_THERE(function) \
    EXPORT int function(void); \
    EXPORT int function(void) { return FAILED; }
#define NOTHING_TO_DO(function) \
    EXPORT int function(void); \
    EXPORT int function(void) { return OK; }

{% if fmi == 3 %}
EXPORT const char *fmi3GetVersion(void);
EXPORT const char *fmi3GetVersion(void) { return "3.0"; }
EXPORT void *fmi3InstantiateCoSimulation(void);
EXPORT void *fmi3InstantiateCoSimulation(void) { return take(); }
EXPORT void *fmi3InstantiateModelExchange(void);
EXPORT void *fmi3InstantiateModelExchange(void) { return 0; }
EXPORT void *fmi3InstantiateScheduledExecution(void);
EXPORT void *fmi3InstantiateScheduledExecution(void) { return 0; }
EXPORT void fmi3FreeInstance(void *instance);
EXPORT void fmi3FreeInstance(void *instance) { is_taken = (instance == 0) && is_taken; }
EXPORT int fmi3Reset(void *instance);
EXPORT int fmi3Reset(void *instance) { return (instance == 0) ? FAILED : begin(); }
EXPORT int fmi3ExitInitializationMode(void *instance);
EXPORT int fmi3ExitInitializationMode(void *instance) { return (instance == 0) ? FAILED : loaded(); }
EXPORT int fmi3GetFloat64(void *instance, const uint32_t *references, size_t count, double *values, size_t values_count);
EXPORT int fmi3GetFloat64(void *instance, const uint32_t *references, size_t count, double *values, size_t values_count)
{
    return ((instance == 0) || (values_count != count)) ? FAILED : get_reals(references, count, values);
}
EXPORT int fmi3SetFloat64(void *instance, const uint32_t *references, size_t count, const double *values, size_t given);
EXPORT int fmi3SetFloat64(void *instance, const uint32_t *references, size_t count, const double *values, size_t given)
{
    return ((instance == 0) || (given != count)) ? FAILED : set_reals(references, count, values);
}
EXPORT int fmi3GetInt32(void *instance, const uint32_t *references, size_t count, int32_t *values, size_t given);
EXPORT int fmi3GetInt32(void *instance, const uint32_t *references, size_t count, int32_t *values, size_t given)
{
    return ((instance == 0) || (given != count)) ? FAILED : get_wholes(references, count, values);
}
EXPORT int fmi3SetInt32(void *instance, const uint32_t *references, size_t count, const int32_t *values, size_t given);
EXPORT int fmi3SetInt32(void *instance, const uint32_t *references, size_t count, const int32_t *values, size_t given)
{
    return ((instance == 0) || (given != count)) ? FAILED : set_wholes(references, count, values);
}
EXPORT int fmi3DoStep(void *instance, double time, double length, bool final, bool *event, bool *terminate, bool *early,
                      double *last);
EXPORT int fmi3DoStep(void *instance, double time, double length, bool final, bool *event, bool *terminate, bool *early,
                      double *last)
{
    const int told = (instance == 0) ? FAILED : step(time, length);
    (void)final;
    *event = false;
    *terminate = false;
    *early = false;
    *last = now;
    return told;
}
{% else %}
EXPORT const char *fmi2GetVersion(void);
EXPORT const char *fmi2GetVersion(void) { return "2.0"; }
EXPORT const char *fmi2GetTypesPlatform(void);
EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }
EXPORT void *fmi2Instantiate(void);
EXPORT void *fmi2Instantiate(void) { return take(); }
EXPORT void fmi2FreeInstance(void *instance);
EXPORT void fmi2FreeInstance(void *instance) { is_taken = (instance == 0) && is_taken; }
EXPORT int fmi2Reset(void *instance);
EXPORT int fmi2Reset(void *instance) { return (instance == 0) ? FAILED : begin(); }
EXPORT int fmi2ExitInitializationMode(void *instance);
EXPORT int fmi2ExitInitializationMode(void *instance) { return (instance == 0) ? FAILED : loaded(); }
EXPORT int fmi2GetReal(void *instance, const uint32_t *references, size_t count, double *values);
EXPORT int fmi2GetReal(void *instance, const uint32_t *references, size_t count, double *values)
{
    return (instance == 0) ? FAILED : get_reals(references, count, values);
}
EXPORT int fmi2SetReal(void *instance, const uint32_t *references, size_t count, const double *values);
EXPORT int fmi2SetReal(void *instance, const uint32_t *references, size_t count, const double *values)
{
    return (instance == 0) ? FAILED : set_reals(references, count, values);
}
EXPORT int fmi2GetInteger(void *instance, const uint32_t *references, size_t count, int32_t *values);
EXPORT int fmi2GetInteger(void *instance, const uint32_t *references, size_t count, int32_t *values)
{
    return (instance == 0) ? FAILED : get_wholes(references, count, values);
}
EXPORT int fmi2SetInteger(void *instance, const uint32_t *references, size_t count, const int32_t *values);
EXPORT int fmi2SetInteger(void *instance, const uint32_t *references, size_t count, const int32_t *values)
{
    return (instance == 0) ? FAILED : set_wholes(references, count, values);
}
EXPORT int fmi2DoStep(void *instance, double time, double length, int final);
EXPORT int fmi2DoStep(void *instance, double time, double length, int final)
{
    (void)final;
    return (instance == 0) ? FAILED : step(time, length);
}
{% endif %}
{% for function in nothing_to_do %}
NOTHING_TO_DO(fmi{{ fmi }}{{ function }})
{% endfor %}
{% for function in not_there %}
NOT_THERE(fmi{{ fmi }}{{ function }})
{% endfor %}
